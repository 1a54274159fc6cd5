"""Every test of a store runs on both engines, PostgreSQL on a real server."""

import importlib.util
import uuid
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


@pytest.fixture(scope="session")
def postgres():
    if server.binaries() is None:
        pytest.skip("no PostgreSQL on this machine: neither PG_BIN nor the package nor Debian's")
    with server.running() as running:
        yield running


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request, tmp_path):
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path}/experiments.db"
        return
    running = request.getfixturevalue("postgres")
    name = "t" + uuid.uuid4().hex[:12]
    admin = sa.create_engine(running.url, isolation_level="AUTOCOMMIT")
    with admin.connect() as connection:
        connection.execute(sa.text(f"CREATE DATABASE {name}"))
    whole = sa.make_url(running.url).set(database=name)
    yield whole.render_as_string(hide_password=False)
    with admin.connect() as connection:
        connection.execute(sa.text(f"DROP DATABASE {name} WITH (FORCE)"))
    admin.dispose()


@pytest.fixture
def store(url, tmp_path):
    with Store(url, tmp_path / "media") as opened:
        opened.upgrade()
        yield opened
