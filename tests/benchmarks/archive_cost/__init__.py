"""The cost of recorded channels compared with a plain writer and two other systems."""
