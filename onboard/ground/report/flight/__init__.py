"""The page of one flight: its data, figures and sections."""
