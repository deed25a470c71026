"""PySyncObj, and all that knows it: no other folder does.

`pinned_copy` loads the library, `node` gives its Raft node the words of the Raft paper, and `seams` puts our log, our
snapshots and our transport where the library expects its own.
"""
