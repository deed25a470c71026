"""Controls how much memory a service process takes from the system and gives back."""
