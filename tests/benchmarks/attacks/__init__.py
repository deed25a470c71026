"""The harm that one hostile caller can do to others: `python -m tests.benchmarks.attacks [NAME...]`."""
