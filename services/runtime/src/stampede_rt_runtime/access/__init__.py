"""Callers and their rights: identities, tokens, rules, and the calls under way."""
