"""Generated from proto/stampede_rt/v1."""
