"""Skin: what is baked once per hand, coloured per person, wrinkled per pose, and drawn."""
