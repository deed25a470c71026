"""The data that a member keeps: its log, term and vote, snapshots, backups, and the known stores of the others."""
