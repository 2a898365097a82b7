"""Picture files: OpenEXR, PNG, animations, and what stored numbers say."""
