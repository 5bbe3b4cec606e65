"""What may be wrong competes on the same data: statistics as numbers, and the policy that weighs them."""
