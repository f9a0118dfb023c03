"""A log through today's controller, onto a bus, or through another loop."""
