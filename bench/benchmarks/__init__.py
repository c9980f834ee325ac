"""The project's benchmarks, as tables: closed loop, bus, FMU, live page and logs.

`make bench` prints them all. Nothing here passes or fails: the tables show targets beside measurements.
"""
