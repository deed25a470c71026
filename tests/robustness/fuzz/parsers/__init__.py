"""Every parser of bytes and texts from outside, called in this process."""
