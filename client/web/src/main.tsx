// SPDX-License-Identifier: MIT
import { render } from "preact";
import { App } from "./ui/app";
import { client } from "./ui/store";
import "./ui/style.css";
import "./ui/rooms.css";

const root = document.getElementById("app");
if (root) render(<App />, root);
client.connect();
