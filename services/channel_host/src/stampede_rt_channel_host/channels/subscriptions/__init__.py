"""The subscriptions to channels: their streams, and the credit of their readers."""
