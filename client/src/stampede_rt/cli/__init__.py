"""The command line `stampede`: a thin shell over the blocking client. Services bring verbs of their own."""
