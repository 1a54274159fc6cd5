"""A whole application over a project folder, in this process."""

import json
import re

from tests.web.client import Client

from fixel.database.project import Project
from fixel.web.app import create_app
from fixel.web.context import ProjectContext
from fixel.web.pages.site import project_pages
from fixel.web.project import project_api
from fixel.web.security import WORD_HEADER, Gate

HERE = "http://127.0.0.1:8000"
# Values for what stands in braces in addresses.
EXAMPLES = {"number": "1", "name": "grasp"}


class Bench:
    """Pages and interface of a project, with their gate."""

    def __init__(self, folder):
        self.folder = folder
        self.gate = Gate()
        self.context = ProjectContext(Project(folder))
        self.api = project_api(self.context)
        self.pages = project_pages(self.context)
        self.app = create_app(self.pages, self.gate, api=self.api, name=self.context.name)
        self.client = self.opened()

    def opened(self, **options):
        """A browser that has opened the link."""
        return Client(
            self.app,
            HERE + self.gate.root,
            cookies={self.gate.cookie: self.gate.session},
            **options,
        )

    def stranger(self, **options):
        """A browser that has not."""
        return Client(self.app, HERE, **options)

    def get(self, path, status=200):
        """Return the content of an answer of the interface for programs."""
        return self._content(self.client.get(f"/api/v1{path}"), status)

    def post(self, path, body=None, status=200):
        """Post to the interface as a page of ours does; return the content of the answer."""
        text = None if body is None else json.dumps(body).encode()
        return self._content(self.send(path, text), status)

    def send(self, path, text):
        """Post a text that may be no JSON; return the whole answer."""
        headers = {WORD_HEADER: self.gate.word, "content-type": "application/json"}
        return self.client.request("POST", f"/api/v1{path}", headers, content=text)

    @staticmethod
    def _content(answer, status):
        assert answer.status_code == status, answer.text
        return answer.json() if answer.content else None

    def submit(self, path, **fields):
        """Post a form with the hidden word of our pages; the answer is not followed."""
        fields = {"fixel-word": self.gate.word} | fields
        return self.opened(follow_redirects=False).request("POST", path, data=fields)

    def addresses(self):
        """Every address with the methods it knows, braces filled in."""
        found = {"/": {"GET"}, "/palette.css": {"GET"}, "/static/style.css": {"GET", "HEAD"}}
        found |= {filled(page.path): {"GET"} for page in self.pages}
        found["/api/v1/openapi.json"] = {"GET"}
        for path, entries in self.api.openapi()["paths"].items():
            found[f"/api/v1{filled(path)}"] = {method.upper() for method in entries}
        return found

    def close(self):
        self.context.close()


def filled(path):
    """An address with examples in place of what stands in braces."""
    return re.sub(r"\{(\w+)\}", lambda found: EXAMPLES.get(found[1], "1"), path)
