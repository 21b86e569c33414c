"""Tables from saved results; nothing here runs a model."""
