"""A host as a member of a cluster: identity, registration, lease, gatekeeper, supernodes."""
