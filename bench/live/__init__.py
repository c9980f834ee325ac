"""Watching a run while it is going on, in a browser and in Foxglove or Lichtblick.

The server is a separate process that reads the log while it is written. Bench and viewers share nothing but that file,
so that no viewer can slow or stop a run.
"""
