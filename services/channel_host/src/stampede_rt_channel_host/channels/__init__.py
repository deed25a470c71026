"""Channels served over gRPC: puts, gets, subscriptions, and the memory they share."""
