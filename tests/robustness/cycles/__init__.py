"""Opens and closes things many times. Afterwards no process may have grown."""
