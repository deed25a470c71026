"""The command line `stampede`: a thin shell over the blocking client. Services add verbs of their own."""
