"""The bench: ECUs on CAN around the vehicle FMU, run by a conductor and recorded to MCAP."""
