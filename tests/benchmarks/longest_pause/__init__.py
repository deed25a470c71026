"""How long a host's event loop stands still for one long piece of work: `python -m tests.benchmarks.longest_pause`."""
