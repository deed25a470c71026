"""The metrics that a service serves to Prometheus (decision 0178)."""
