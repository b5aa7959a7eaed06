"""What the addresses stand for: plans, scenes and webhooks as one caller sees them, and how they are told."""
