"""The values that callers give and get. Pure."""
