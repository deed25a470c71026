"""The values that callers give to and get from the client. Pure."""
