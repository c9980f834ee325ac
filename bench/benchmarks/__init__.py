"""What the project is measured by, as tables: the closed loop (`loop`) and the vehicle's FMU (`fmu`).

`make bench` prints them all. Nothing here passes or fails: the tables say what is wanted beside what is measured.
"""
