"""The MCAP log: writing, reading, comparing."""
