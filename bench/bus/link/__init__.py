"""Links to buses: SocketCAN, UDP multicast, in-process, any python-can interface; and their addresses."""
