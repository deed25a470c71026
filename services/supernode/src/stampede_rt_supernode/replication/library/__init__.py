"""PySyncObj, and all code that knows this library. No other folder knows it.

`pinned_copy` loads the library. `node` gives its Raft node the names of the Raft paper. `adapters` puts our log, our
snapshots and our transport in the place of the library's own.
"""
