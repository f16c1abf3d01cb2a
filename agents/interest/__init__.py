"""The peers to which an agent with neighbours only subscribes: tiles, positions, selection and subscriptions."""
