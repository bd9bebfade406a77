"""The paper's tables: published figures beside measured ones, as text, data and pictures."""
