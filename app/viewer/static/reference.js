/* The interface's reference: Swagger UI over this service's own description, in the colours the system asks for. */
"use strict";

const dark = matchMedia("(prefers-color-scheme: dark)");
const follow = () => document.documentElement.classList.toggle("dark-mode", dark.matches);
dark.addEventListener("change", follow);
follow();

window.ui = SwaggerUIBundle({ url: "/openapi.json", dom_id: "#reference", defaultModelsExpandDepth: 0, validatorUrl: null });
