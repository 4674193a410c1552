"""Shapes to learn from: closed-form, procedural and real ones, traced, filtered and augmented."""
