// @ts-check
// A filter as one types it: words apart by blanks, "in quotes" where a word has some.

/** @param {string} filter @returns {string[]} */
export function tokens(filter) {
  return filter.match(/(?:"[^"]*"?|[^\s"])+/g) ?? [];
}

/** @param {string} token */
const bare = (token) => token.replaceAll('"', "");

/** What a token is about: `shape` of `shape=square`, `flag` of `flag:late`. @param {string} token */
export function subject(token) {
  const found = /^([\w.-]+)(?:[<>!]?=|[<>:])/.exec(bare(token));
  return found ? found[1] : "";
}

/** @param {string} filter @param {string[]} subjects */
export const without = (filter, subjects) =>
  tokens(filter).filter((token) => !subjects.includes(subject(token))).join(" ");

/** Tokens that are about something. @param {string} filter @param {string} about */
export const about = (filter, about) => tokens(filter).filter((token) => subject(token) === about).map(bare);

/** @param {string} filter @param {string} token */
export const has = (filter, token) => tokens(filter).map(bare).includes(bare(token));

/** @param {string} filter @param {...string} more */
export const and = (filter, ...more) => [...tokens(filter), ...more].join(" ");

/** A value as it stands in a filter. @param {string} text */
export const quoted = (text) => (/[\s"]/.test(text) ? `"${text.replaceAll('"', "")}"` : text);
