#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Signed links: a picture without a token until the link expires or its token is revoked, for pages
of any origin; nothing else with it. Pages of allowed origins may read the API.

   signed_links.py FOLDER_OF_THE_PROGRAMS"""
import base64
import hashlib
import hmac
import json
import os
import subprocess
import sys
import time
import urllib.parse

from web import OCTAHEDRON, SMALL, Daemon, sky

PATH = "/v1/models/small/image.jpg?env=studio&rotate=30&size=64x48"
FOREIGN = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}


def relight(d, *arguments, token=None, expect=0):
    environment = dict(os.environ, RELIGHT_SERVER="unix:%s/s" % d.folder)
    environment.pop("RELIGHT_TOKEN", None)
    if token:
        environment["RELIGHT_TOKEN"] = token
    done = subprocess.run([d.binaries + "/relight", *arguments], env=environment,
                          capture_output=True, text=True, timeout=60)
    assert done.returncode == expect, (arguments, done.returncode, done.stderr)
    return (done.stdout if not expect else done.stderr).strip()


def refused(d, url, status=403, method="GET", headers=None):
    got, answer, body = d.ask(method, url, headers=headers)
    assert got == status, (url, got, body[:300])
    assert not body.startswith(b"\xff\xd8")
    return json.loads(body) if body.startswith(b"{") else None


def sign(token, by, path, query, expires):
    """As PROTOCOL.md says it, without a daemon."""
    pairs = sorted(urllib.parse.parse_qsl(query) + [("by", by), ("expires", str(expires))])
    text = "&".join(name + "=" + urllib.parse.quote(value, safe="-._~") for name, value in pairs)
    key = hashlib.blake2b(token.encode(), digest_size=32).digest()
    said = "relight-url-1\n%s\n%s" % (urllib.parse.quote(path, safe="-._~/"), text)
    mac = hmac.new(key, said.encode(), hashlib.sha256).digest()
    return "%s?%s&sig=%s" % (path, text, base64.urlsafe_b64encode(mac).decode().rstrip("="))


def pictures_by_link(d, shop):
    link = relight(d, "sign", PATH, token=shop)
    assert "by=shop" in link and "expires=" in link
    status, headers, picture = d.ask("GET", link)
    assert status == 200 and headers["content-type"] == "image/jpeg" and picture[:2] == b"\xff\xd8"
    # Caches keep it for five minutes at most, and no longer than the link lives.
    assert headers["cache-control"] == "public, max-age=300", headers
    brief = d.ask("GET", relight(d, "sign", "--expires", "100s", PATH, token=shop))
    assert brief[0] == 200 and 1 <= int(brief[1]["cache-control"].split("max-age=")[1]) <= 100
    assert headers["cross-origin-resource-policy"] == "cross-origin"
    # The same with the token itself, and again by its tag.
    own = d.ask("GET", PATH, headers={"Authorization": "Bearer " + shop})
    assert own[2] == picture and "max-age" not in own[1]["cache-control"]
    assert d.ask("GET", link, headers={"If-None-Match": headers["etag"]})[0] == 304
    assert d.ask("HEAD", link)[0] == 200
    # In a page of another origin, as <img> and as <img crossorigin>.
    assert d.ask("GET", link, headers=FOREIGN)[2] == picture
    far = d.ask("GET", link, headers={"Origin": "https://shop.example"})
    assert far[0] == 200 and far[1]["access-control-allow-origin"] == "https://shop.example"
    # Parameters in another order and with other escapes are the same link.
    path, query = link.split("?")
    words = query.split("&")
    assert d.ask("GET", path + "?" + "&".join(reversed(words)))[2] == picture
    assert d.ask("GET", link.replace("studio", "%73tudio"))[2] == picture
    # A thumbnail of the environment, by its name, and by a link.
    thumbnail = "/v1/environments/studio/image.jpg?width=64"
    status, headers, small = d.ask("GET", thumbnail, headers={"Authorization": "Bearer " + shop})
    assert status == 200 and headers["content-type"] == "image/jpeg" and small[:2] == b"\xff\xd8"
    assert d.ask("GET", relight(d, "sign", thumbnail, token=shop), headers=FOREIGN)[2] == small
    for wrong in ("width=31", "width=1026", "width=33", "height=3"):
        assert d.ask("GET", "/v1/environments/studio/image.jpg?" + wrong,
                     headers={"Authorization": "Bearer " + shop})[0] == 400
    assert d.ask("GET", "/v1/environments/nowhere/image.jpg",
                 headers={"Authorization": "Bearer " + shop})[0] == 404
    return link


def tampering(d, link, shop):
    for old, new in (("rotate=30", "rotate=31"), ("64x48", "4096x4096"), ("studio", "constant"),
                     ("small", "other"), ("image.jpg", "image.png"), ("by=shop", "by=default"),
                     ("by=shop", "by=anna"), ("&rotate=30", "")):
        assert old in link
        refused(d, link.replace(old, new, 1))
    expires = link.split("expires=")[1].split("&")[0]
    refused(d, link.replace(expires, str(int(expires) + 1)))
    refused(d, link + "&max_error=0.5")
    refused(d, link[:-1] + ("A" if link[-1] != "A" else "B"))
    refused(d, link.split("&sig=")[0] + "&sig=")
    refused(d, link.split("&sig=")[0] + "&sig=" + "A" * 43)
    # Nothing but pictures, and no other method.
    for path in ("/v1/models", "/v1/models/small", "/v1/models/small/colors", "/metrics", "/healthz"):
        refused(d, path + "?" + link.split("?")[1])
        refused(d, path + "?sig=x", headers=FOREIGN)
        refused(d, path + "?" + urllib.parse.urlsplit(sign(shop, "shop", path, "", int(expires))).query)
    refused(d, link, method="DELETE")
    # A signature does not lend rights to a socket.
    got = d.ask("GET", "/ws?" + link.split("?")[1], headers={
        "Origin": "https://evil.example", "Connection": "Upgrade", "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
        "Sec-WebSocket-Protocol": "relight.v1"})[0]
    assert got == 403, got
    assert "audit act=refused" in d.log() and "link=/v1/models/small/image.jpg" in d.log()


def urls_that_are_refused(d, shop):
    """What is no path with whole escapes, or holds a control character in any of its parts, is not signed."""
    path, query = PATH.split("?")
    for bad in ("%00", "%01", "%1f", "%1F", "%7f", "%7F", "%", "%4", "%zz", "%4g"):
        for url in (path + bad, path + bad + "?" + query, PATH + "&x" + bad + "=1", PATH + "&x=1" + bad,
                    PATH + "&x=" + bad + "/1"):
            said = relight(d, "sign", url, token=shop, expect=1)
            assert "broken %XX" in said, (url, said)
    for url in (PATH[1:], PATH + "#x", "http://x" + PATH):
        assert "expected a path of this daemon" in relight(d, "sign", url, token=shop, expect=1)
    for other in ("/v1/models", "/v1/models/small", "/v1/models/small/colors", "/v1/rooms/r/image.png", "/metrics", "/",
                  "/v1/models/small/image.jpg/x", "/v1/environments/studio/image.png"):
        assert "links are for pictures" in relight(d, "sign", other, token=shop, expect=1), other
    assert "more parameters" in relight(d, "sign", PATH + "&a=1" * 500, token=shop, expect=1)
    # Other characters are kept, escaped or not.
    for good in ("%20", "%7E", "~", "%C3%A4", "\u00e4", "+"):
        link = relight(d, "sign", PATH + "&name=a" + good + "b", token=shop)
        assert "name=a%sb&" % {"+": "%20", "%7E": "~", "\u00e4": "%C3%A4"}.get(good, good) in link, link
        assert d.ask("GET", link)[0] == 400 and "&sig=" in link, link  # signed, and no such parameter


def links_made_without_a_daemon(d, shop, picture):
    path, query = PATH.split("?")
    soon = int(time.time()) + 60
    assert d.ask("GET", sign(shop, "shop", path, query, soon))[2] == picture
    problem = refused(d, sign(shop, "shop", path, query, int(time.time()) - 1))
    assert "expired" in problem["detail"], problem
    refused(d, sign(shop + "x", "shop", path, query, soon))


def expiry_and_revocation(d, shop):
    for expires in (2, 4, 8, 16):  # one that lives long enough for this machine to ask
        link = relight(d, "sign", "--expires", "%ds" % expires, PATH, token=shop)
        if d.ask("GET", link)[0] == 200:
            break
    else:
        raise AssertionError("a link that lives 16 s is refused")
    time.sleep(expires + 0.1)
    assert "expired" in refused(d, link)["detail"]
    link = relight(d, "sign", "--expires", "366d", PATH, token=shop)
    relight(d, "sign", "--expires", "367d", PATH, token=shop, expect=2)
    assert d.ask("GET", link)[0] == 200
    relight(d, "token", "revoke", "shop")
    refused(d, link)
    # A token of the same name has another key.
    relight(d, "token", "create", "--name", "shop", "--scope", "view")
    refused(d, link)


def who_may_sign(d):
    upload = relight(d, "token", "create", "--name", "up", "--scope", "upload")
    assert "view" in relight(d, "sign", PATH, token=upload, expect=1)
    # Nor does what it signs itself lend a right that it does not have.
    path, query = PATH.split("?")
    soon = int(time.time()) + 600
    assert "view" in refused(d, sign(upload, "up", path, query, soon))["detail"]
    # A link ends with its token.
    short = relight(d, "token", "create", "--name", "short", "--scope", "view", "--expires", "1s")
    time.sleep(1.1)
    refused(d, sign(short, "short", path, query, soon))
    # root's socket has every right, but no token that a link could end with
    assert "token" in relight(d, "sign", PATH, expect=1)
    slow = relight(d, "token", "create", "--name", "slow", "--scope", "view", "--rate", "0.01")
    link = relight(d, "sign", "/v1/models/small/image.jpg?env=constant&size=32x32", token=slow)
    got = [d.ask("GET", link)[0] for _ in range(12)]
    assert got[0] == 200 and got[-1] == 429, got
    for wrong in ("image.jpg", "https://x/v1", PATH + "#a", PATH + "&sig=1", PATH + "&token=a",
                  PATH + "&a=%zz", "/" + "x" * 600):
        relight(d, "sign", wrong, token=slow, expect=1)


def pages_of_other_origins(d, shop):
    ours = {"Origin": "https://ours.example"}
    status, headers, _ = d.ask("OPTIONS", "/v1/models", headers={
        **ours, "Access-Control-Request-Method": "GET", "Access-Control-Request-Headers": "authorization"})
    assert status == 204 and headers["access-control-allow-origin"] == "https://ours.example"
    assert "authorization" in headers["access-control-allow-headers"]
    status, headers, _ = d.ask("GET", "/v1/models", headers={**ours, "Authorization": "Bearer " + shop})
    assert status == 200 and headers["access-control-allow-origin"] == "https://ours.example"
    assert headers["vary"] == "origin"
    for other in ("https://evil.example", "https://ours.example.evil.example", "https://ours.example:8443",
                  "http://ours.example", "https://ours.exampl"):
        for method in ("OPTIONS", "GET"):
            assert d.ask(method, "/v1/models", headers={"Origin": other})[0] == 403, other


def main():
    d = Daemon(sys.argv[1], "--origins", "https://ours.example")
    try:
        shop = relight(d, "token", "create", "--name", "shop", "--scope", "view,upload")
        with open(d.folder + "/studio.hdr", "wb") as f:
            f.write(sky())
        relight(d, "env", d.folder + "/studio.hdr", token=shop)
        with open(d.folder + "/small.obj", "wb") as f:
            f.write(OCTAHEDRON)
        relight(d, "load", d.folder + "/small.obj", "--size-mm", "10", "--material", "marble", "--preview",
                token=shop)
        link = pictures_by_link(d, shop)
        picture = d.ask("GET", link)[2]
        tampering(d, link, shop)
        urls_that_are_refused(d, shop)
        links_made_without_a_daemon(d, shop, picture)
        pages_of_other_origins(d, shop)
        who_may_sign(d)
        expiry_and_revocation(d, shop)
    finally:
        d.end()


main()
