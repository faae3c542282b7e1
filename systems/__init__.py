"""Drake LeafSystems, one folder per capability, each with the numeric functions that its systems call."""
