"""The gets of channels: their streams, the blocked ones, and the answers on their way to the callers."""
