"""A run watched while it goes on: in a browser, and in Foxglove or Lichtblick.

The server is a process of its own that reads the log as it is written. Bench and viewers share nothing but that file,
so that no viewer can slow or stop a run.
"""
