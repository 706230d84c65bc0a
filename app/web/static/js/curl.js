// The command line that does what the form does.

import { address, storedKey } from "./api.js";

/** Return the curl command of a query; `fields` are its form fields without the image. */
export function curlCommand(fileName, fields) {
  const parts = [`curl ${quoted(address("locate"))}`];
  if (storedKey.get()) parts.push('-H "Authorization: Bearer $ROOMFIX_KEY"');
  parts.push(`-F ${quoted(`image=@${fileName}`)}`);
  for (const [name, value] of Object.entries(fields)) parts.push(`-F ${quoted(`${name}=${value}`)}`);
  return parts.join(" \\\n  ");
}

function quoted(text) {
  return /^[\w@%+=:,./-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`;
}
