"""Recordings: MCAP files of channels. The modules need the extra `stampede-rt[files]`, except the pure ones."""
