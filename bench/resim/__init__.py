"""Runs an ECU again on the frames that a log says it saw, and compares what it sends: `platoon resim`."""
