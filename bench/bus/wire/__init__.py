"""Frames on the wire: their length with stuff bits, arbitration, and whether all meet their deadlines."""
