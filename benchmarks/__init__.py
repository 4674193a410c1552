"""Commands that measure riemlayer and its rivals."""
