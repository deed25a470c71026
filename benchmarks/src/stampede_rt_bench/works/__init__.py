"""Work that several systems do in turn, and how it is measured. What does the work is in `limits` and `peers`."""
