"""CAN: opening buses, the DBC codec, end-to-end protection."""
