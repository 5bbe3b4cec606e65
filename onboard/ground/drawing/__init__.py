"""How pages look: theme of the figures, HTML fragments, figures that zoom."""
