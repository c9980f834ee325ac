"""Campaigns: many runs of one scenario over its uncertainties, and what they say together."""
