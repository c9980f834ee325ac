"""Runs a command where there is SocketCAN: on this kernel, or in a small one that has it (user-mode Linux).

User-mode Linux is the Linux kernel as an ordinary program. It sees this machine's files, has one core, and brings the
CAN modules that the kernels of many clouds and containers lack. `run` is what the caller sees, `machine` the program,
`guest` the first process inside it, `wire` what these two tell each other.
"""
