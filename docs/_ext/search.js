// Scores of search results: what tells how to do something comes before what records why.
// The theme's search reads `Scorer`; see `html_search_scorer` of Sphinx.
const PLACES = {
  "get-started": 12, "how-to/": 14, "tutorials/": 12, "gallery/": 4, "reference/": 4,
  "evidence/": -4, "project/": -12, "decisions/": -100,
};

var Scorer = {
  /** @param {[string, string, string, string | null, number, string, string]} result */
  score: ([page, , , , score]) => {
    const place = Object.keys(PLACES).find((one) => page.startsWith(one));
    return score + (place ? PLACES[place] : 0);
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
