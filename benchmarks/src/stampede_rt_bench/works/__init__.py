"""The work that several systems do in turn, and its measurement. The systems are in `limits` and `peers`."""
