"""The traffic between members: messages, their encoding, and the buffer in which they wait."""
