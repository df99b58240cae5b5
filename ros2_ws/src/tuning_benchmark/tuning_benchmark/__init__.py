"""The campaign: many tuning runs side by side, judged by the truth, as tables and figures."""
