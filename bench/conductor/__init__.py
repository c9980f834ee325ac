"""Starts and watches the processes and owns the clock."""
