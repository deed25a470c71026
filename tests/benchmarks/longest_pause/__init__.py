"""The longest time that one piece of work blocks a host's event loop: `python -m tests.benchmarks.longest_pause`."""
