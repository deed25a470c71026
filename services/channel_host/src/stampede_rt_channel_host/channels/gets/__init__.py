"""The gets of channels: their streams, the blocked gets, and the answers on their way to the callers."""
