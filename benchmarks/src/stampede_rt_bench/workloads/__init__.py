"""The workloads that several systems run in turn, and their measurement. The systems are in `limits` and `peers`."""
