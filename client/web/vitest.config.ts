// SPDX-License-Identifier: MIT
import { defineConfig } from "vitest/config";

// No test fails on time: a busy machine is slow.
export default defineConfig({ test: { include: ["test/**/*.test.ts"], testTimeout: 120_000 } });
