"""The figures of the paper, section 6, and what the time model promises about cost."""
