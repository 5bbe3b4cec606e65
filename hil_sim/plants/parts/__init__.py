"""What acts on the bodies of a plant: jets, pucks, contact and soft parts."""
