// SPDX-License-Identifier: MIT
// Links for people without a token: made, listed and revoked by the room's owner.
import { useSignal } from "@preact/signals";
import { useRef } from "preact/hooks";
import { RoomRole } from "../gen/relight_pb";
import { act } from "../room/edits";
import { roomId, state } from "../room/here";
import { LinkField, useEscape, useFocus } from "./controls";
import { copied } from "./copy";

const DAY_S = 86400;

/** The link to the room that the page is in; empty where it was refused. */
export async function invite(name: string, may: RoomRole, days: number): Promise<string> {
  const room = roomId.value; // the answer may come when the page is in another one
  const expiresS = BigInt(Math.floor(Date.now() / 1000) + days * DAY_S);
  const answer = await act({ invite: { name, role: may, expiresS } });
  if (!answer?.secret) return "";
  const url = new URL(location.pathname, location.href);
  url.searchParams.set("room", room);
  url.hash = `token=${answer.secret}`;
  return url.href;
}

function expiry(expiresS: bigint): string {
  if (!expiresS) return "does not expire";
  const at = new Date(Number(expiresS) * 1000);
  return `${at.getTime() < Date.now() ? "expired" : "until"} ${at.toLocaleDateString()}`;
}

function Made() {
  const list = (state.value?.invites ?? []).filter((one) => !one.revoked);
  if (!list.length) return null;
  return (
    <ul class="pins" aria-label="Links that were made">
      {list.map((one) => (
        <li key={one.id} class="row">
          <span class="pin-text">
            {one.name}
            <small>
              {" "}
              may {one.role === RoomRole.ROLE_REVIEWER ? "review" : "look"},{" "}
              {expiry(one.expiresS)}
            </small>
          </span>
          <button
            type="button"
            aria-label={`Revoke the link of ${one.name}`}
            onClick={() => void act({ revoke: one.id })}
          >
            Revoke
          </button>
        </li>
      ))}
    </ul>
  );
}

export function Invite({ close }: { close: () => void }) {
  const name = useSignal("");
  const may = useSignal(RoomRole.ROLE_REVIEWER);
  const days = useSignal(14);
  const link = useSignal("");
  const isCopied = useSignal(false);
  const making = useSignal(false); // no second link is made meanwhile
  const node = useRef<HTMLFormElement>(null);
  useEscape(true, close);
  useFocus(node);
  const make = async () => {
    if (making.value) return;
    making.value = true;
    const url = await invite(name.value || "guest", may.value, days.value);
    isCopied.value = url !== "" && (await copied(url));
    link.value = url;
    making.value = false;
  };
  return (
    <form
      ref={node}
      class="popover"
      aria-label="Invite"
      tabIndex={-1}
      onSubmit={(event) => {
        event.preventDefault();
        void make();
      }}
    >
      <label>
        For whom
        <input
          value={name.value}
          onInput={(event) => (name.value = event.currentTarget.value)}
        />
      </label>
      <label>
        May
        <select
          value={may.value}
          onChange={(event) => (may.value = Number(event.currentTarget.value) as RoomRole)}
        >
          <option value={RoomRole.ROLE_REVIEWER}>review</option>
          <option value={RoomRole.ROLE_VIEWER}>look</option>
        </select>
      </label>
      <label>
        For how long
        <select
          value={days.value}
          onChange={(event) => (days.value = Number(event.currentTarget.value))}
        >
          {[1, 14, 90].map((n) => (
            <option key={n} value={n}>
              {n === 1 ? "a day" : `${n} days`}
            </option>
          ))}
        </select>
      </label>
      <button type="submit" class="primary" disabled={making.value}>
        Make a link
      </button>
      {link.value && (
        <>
          <LinkField label="Invitation" url={link.value} />
          <p class="hint">
            {isCopied.value
              ? "It is copied, and"
              : "The browser does not copy it: copy it here. It is"}{" "}
            shown this once. Whoever has it is let in.
          </p>
        </>
      )}
      <Made />
      <button type="button" class="quiet" onClick={close}>
        Close
      </button>
    </form>
  );
}
