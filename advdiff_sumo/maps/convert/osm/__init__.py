"""Streets of OpenStreetMap beyond the rim of an HD map."""
