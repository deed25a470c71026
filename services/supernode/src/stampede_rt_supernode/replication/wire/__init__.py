"""The messages between members, their encoding, and the buffer in which they wait."""
