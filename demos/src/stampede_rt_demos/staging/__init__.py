"""What every demo stands on: role processes and their reports, the film, real-time putting, accounting."""
