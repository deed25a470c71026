"""The streams between members: links out, the service in, and the hello that begins each stream."""
