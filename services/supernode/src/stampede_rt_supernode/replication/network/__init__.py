"""The streams between members: outgoing links, the incoming service, and the hello at the start of each stream."""
