"""The results page of a campaign, from its records: tables, figures and sentences."""
