/* The page that asks for a key: what stands behind # in the address, which a service never sees, is kept. */
"use strict";

document.querySelector("form").elements.next.value += location.hash;
