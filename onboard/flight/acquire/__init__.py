"""From open buses to rings: drivers are pumped, drives armed, and what never came is a gap."""
