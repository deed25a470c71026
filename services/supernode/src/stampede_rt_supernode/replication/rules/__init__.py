"""The rules of Raft: one node, elections, leading, following, members, confirmed reads and proposals."""
