"""Runs the migrations on the engine that `app.storage.db.Database.migrate` hands over."""

from alembic import context

from app.storage.tables import metadata

engine = context.config.attributes["engine"]
with engine.connect() as connection:
    # render_as_batch: SQLite alters tables by copying them.
    context.configure(connection=connection, target_metadata=metadata, render_as_batch=True)
    with context.begin_transaction():
        context.run_migrations()
    connection.commit()
