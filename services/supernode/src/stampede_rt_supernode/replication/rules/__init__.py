"""The rules of Raft: the node, elections, leading, following, members, confirmed reads and proposals."""
