"""The cost of recorded channels beside a plain writer and two other systems."""
