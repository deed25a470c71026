"""Messages of a service to the supervisor that started it."""
