"""Checks of any FMU, also while it runs: `validate` lists what they found."""
