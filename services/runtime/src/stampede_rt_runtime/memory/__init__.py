"""The memory of a service process: what it takes from the system, and gives back."""
