// SPDX-License-Identifier: MIT
// Settings of materials whose fragments are added to the target.
import { CustomBlending, OneFactor } from "three";

export const ADDITIVE = {
  depthTest: false,
  depthWrite: false,
  transparent: true,
  blending: CustomBlending,
  blendSrc: OneFactor,
  blendDst: OneFactor,
} as const;
