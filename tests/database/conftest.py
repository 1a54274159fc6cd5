"""Every test of a store runs on both engines, PostgreSQL on a real server."""

import importlib.util
from pathlib import Path

import pytest
import sqlalchemy as sa

from fixel.database.store import Store


def _server_module():
    # Tests are imported one by one, not as packages; a helper beside them is loaded by its path.
    spec = importlib.util.spec_from_file_location("server", Path(__file__).with_name("server.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


server = _server_module()
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
