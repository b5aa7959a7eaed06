"""What is kept in the database: jobs, plans, scenes, meshes and webhooks, and the tables that hold them."""
