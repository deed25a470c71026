"""Who calls, what they may do, and how that is known: identities, tokens, rules, and the calls under way."""
