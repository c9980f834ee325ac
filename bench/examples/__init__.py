"""Templates for custom ECUs: in Python `single_track.py` and `follow.py`, in C `tracker/`."""
