"""What one hostile caller can take from the others: `python -m tests.benchmarks.attacks [NAME...]`."""
