"""Every test of a store runs on both engines, PostgreSQL on a real server."""

import pytest
import sqlalchemy as sa
from tests.database import server

from fixel.database.store import Store

# A test that failed may have left a connection that holds a lock.
OTHERS = """SELECT pg_terminate_backend(pid) FROM pg_stat_activity
WHERE datname = current_database() AND pid <> pg_backend_pid()"""


@pytest.fixture(scope="session")
def postgres():
    if server.binaries() is None:
        pytest.skip("no PostgreSQL on this machine: neither PG_BIN nor the package nor Debian's")
    with server.running() as running:
        yield running


@pytest.fixture(scope="session")
def database(postgres):
    """An engine of a database on the server, which the next test finds empty again."""
    engine = sa.create_engine(postgres.url, isolation_level="AUTOCOMMIT")
    yield engine
    engine.dispose()


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.system)])
def url(request, tmp_path):
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path}/experiments.db"
        return
    emptied = request.getfixturevalue("database")
    yield emptied.url.render_as_string(hide_password=False)
    # The server needs half the time for this that it needs for another database.
    with emptied.connect() as connection:
        connection.execute(sa.text(OTHERS))
        connection.execute(sa.text("DROP SCHEMA public CASCADE"))
        connection.execute(sa.text("CREATE SCHEMA public"))


@pytest.fixture
def store(url, tmp_path):
    with Store(url, tmp_path / "media") as opened:
        opened.upgrade()
        yield opened
