// Prints the schemas that Foxglove publishes, as JSON by name: node schemas.mjs
import schemas from "@foxglove/schemas/jsonschema.js";

console.log(JSON.stringify(Object.fromEntries(Object.values(schemas).map((schema) => [schema.title, schema]))));
