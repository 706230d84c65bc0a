// Starts Swagger UI on the server's own description of its API.

window.SwaggerUIBundle({
  url: new URL("openapi.json", document.baseURI).href,
  dom_id: "#swagger-ui",
  deepLinking: true,
  displayRequestDuration: true,
  persistAuthorization: false,
  // The default would send the description to a validator on another host.
  validatorUrl: null,
});
