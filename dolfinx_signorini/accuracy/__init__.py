"""The dial: a search for mesh, degree and tolerance that reach an accuracy or fill a budget."""
