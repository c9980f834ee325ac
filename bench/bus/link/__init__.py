"""Ends of buses: SocketCAN, UDP multicast, one process, any python-can interface; and the addresses that name them."""
