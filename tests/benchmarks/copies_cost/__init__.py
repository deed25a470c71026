"""The costs of copies and moves: `python -m tests.benchmarks.copies_cost`."""
