"""How requests travel. Everything above works the same on each; `_async` and `_sync` names pair up."""
