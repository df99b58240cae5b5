"""The truth of the milling studies: many cuts at once, and the judge that asks for them."""
