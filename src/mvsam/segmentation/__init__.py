"""Sec. 3.3 and Figure 4: prompts, the two-way transformer, and the semantic decoder."""
