"""ECUs of one's own to begin from: in Python `single_track.py` and `follow.py`, in C `tracker/`."""
