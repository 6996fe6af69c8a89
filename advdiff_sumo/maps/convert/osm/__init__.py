"""OpenStreetMap streets that continue an HD map beyond its rim."""
