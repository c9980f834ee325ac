"""Runs a command with SocketCAN: on this kernel, or in a small one that has it (user-mode Linux).

User-mode Linux is the Linux kernel as an ordinary program. It sees this machine's files, has one core, and brings the
CAN modules that the kernels of many clouds and containers lack. `run` is the caller's side, `machine` starts the
kernel, `guest` is the first process inside it, `wire` is the protocol between the two.
"""
