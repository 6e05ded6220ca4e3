#!/bin/sh
# SPDX-License-Identifier: MIT
# Every citation resolves: METHODS sections to headings of libprt/METHODS.md, keys of papers to its
# bibliography, "KEY eq N" to its table of equations; pages name files and functions() that exist, and
# METHODS.md functions that are in the file named beside. Then the same check on copies that are broken
# on purpose, each of which must fail.
#   citations.sh SOURCE_FOLDER
set -eu
root=$1

check() {
    perl -CSD -Mutf8 - "$1" <<'PERL'
use strict;
use warnings;
use File::Find;

my ($root) = @ARGV;
my $bad = 0;
sub slurp { open my $f, '<:encoding(UTF-8)', $_[0] or die "$_[0]: $!\n"; local $/; <$f> }
sub fail { print "error: $_[0]\n"; $bad++ }

# Words of comments that look like keys and are formats, instruction sets or standards.
my %word = map { $_ => 1 } qw(AMD64 B44 C11 C17 D65 DX10 EGSR07 F16 F32 F64 I16 I32 I64 M68 PCG32 PNG16 R16
    RGB10 RGBA16 RGBA32 U16 U32 U64 UTF16 X86);

# ---- what METHODS.md offers
my $methods = slurp("$root/libprt/METHODS.md");
my (%section, %anchor, %key, %equation, @title, $bibliography);
while ($methods =~ /^#+ (.*)$/mg) {
    my $title = $1;
    $section{$1} = 1 if $title =~ /^(\d+(?:\.\d+)?)\.? /;
    push @title, lc $title;
    (my $a = lc $title) =~ s/[^\w\- ]//g;
    $a =~ tr/ /-/;
    $anchor{$a} = 1;
}
($bibliography) = $methods =~ /^## \d+\. Bibliography$(.*)/ms or fail("METHODS.md has no bibliography");
$key{$1} = 1 while ($bibliography // '') =~ /^\| ([A-Z]+\d\d) \|/mg;
$equation{"$1 $2"} = 1 while $methods =~ /^\| ([A-Z]+\d\d) eq (\d+) \|/mg;
fail('METHODS.md: no sections, keys or equations were found')
    unless %section && %key && %equation;

# ---- what METHODS.md names
while ($methods =~ /`([a-z]\w*\/[\w\/]+\.(?:c|h|cpp))`/g) {
    fail("METHODS.md names $1, which does not exist")
        unless -e "$root/libprt/$1" || -e "$root/$1";
}
while ($methods =~ /\]\(#([^)]+)\)/g) {
    fail("METHODS.md links to #$1, which is no heading") unless $anchor{$1};
}
while ($methods =~ /^\| ([A-Z]+\d\d(?: eq \d+)?) \|[^|\n]*\|([^|\n]*)\|$/mg) {
    my ($row, $where, $source) = ($1, $2, undef);
    for my $name ($where =~ /`([^`]+)`/g) {
        if ($name =~ /\//) {
            my $path = "$root/libprt/$name";
            $source = -e $path ? slurp($path) : undef;
        } elsif (!defined $source || index($source, $name) < 0) {
            fail("METHODS.md, $row: $name is not in the file that is named before it");
        }
    }
}

# ---- citations
my $space = qr/(?:[ \t]|\n[ \t]*(?:\/\/|\*|#)?[ \t]*)*/; # a comment's line break, too
my @names = (['Christensen & Burley', 'CB15'], ['Donner & Jensen', 'DJ05']);

# Comments of C, prose of Markdown, all of the others.
sub prose {
    my ($file, $text) = @_;
    if ($file =~ /\.md$/) {
        $text =~ s/^```.*?^```//gms;
        $text =~ s/`[^`\n]*`//g;
        return $text;
    }
    return $text unless $file =~ /\.(?:c|h|cpp|proto)$/;
    my $out = '';
    while ($text =~ m{"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*'|(//[^\n]*|/\*.*?\*/)}gs) {
        $out .= "$1\n" if defined $1;
    }
    return $out;
}

sub look {
    my ($file, $text) = @_;
    (my $name = $file) =~ s/^\Q$root\E\///;
    while ($text =~ /METHODS(?:\.md)?(?:'s?)?$space(?:§|section$space)?$space(\d+(?:\.\d+)?)((?:$space(?:–|,$space§?|and$space§)$space\d+(?:\.\d+)?(?=[).,;:]|\s))*)/g) {
        for my $n ($1, ($2 // '') =~ /(\d+(?:\.\d+)?)/g) {
            fail("$name cites METHODS §$n, which is no heading of libprt/METHODS.md")
                unless $section{$n};
        }
    }
    while ($text =~ /METHODS(?:\.md)?$space"([^"]+)"/g) {
        my $title = lc $1;
        fail("$name cites METHODS \"$title\", which is no heading of libprt/METHODS.md")
            unless grep { index($_, $title) >= 0 } @title;
    }
    while ($text =~ /METHODS\.md#([\w-]+)/g) {
        fail("$name links to METHODS.md#$1, which is no heading") unless $anchor{$1};
    }
    for my $pair (@names) {
        my ($who, $key) = @$pair;
        $text =~ s/\Q$who\E(?: \d{4})?,?(?= eq)/$key/g;
    }
    while ($text =~ /\b([A-Z]{1,6}\d\d)\b/g) {
        fail("$name cites $1, which is not in the bibliography of libprt/METHODS.md (a format's " .
             "name goes into the list of words in tests/unit/citations.sh)")
            unless $key{$1} || $word{$1};
    }
    while ($text =~ /\b([A-Z]{1,6}\d\d),?${space}eqs?\.?$space(\d+)((?:(?:-|–| and | to |, )\d+)*)/g) {
        my ($paper, $first, $more) = ($1, $2, $3);
        my @n = ($first);
        while ($more =~ /(-|–| and | to |, )(\d+)/g) {
            push @n, $1 eq ', ' || $1 eq ' and ' ? $2 : $n[-1] + 1 .. $2;
        }
        for my $n (@n) {
            fail("$name cites $paper eq $n, which the table of equations in libprt/METHODS.md lacks")
                unless $equation{"$paper $n"};
        }
    }
}

# Files that a page names, from its own folder, the root or a part's: `net/request.c`, [x](../y.md).
# Words in capitals stand for a name.
sub look_paths {
    my ($file, $text) = @_;
    (my $name = $file) =~ s/^\Q$root\E\///;
    (my $folder = $file) =~ s/\/[^\/]*$//;
    $text =~ s/https?:\S+//g;
    while ($text =~ /(?<![\w.\/~-])((?:[\w.-]+\/)+[\w-]+\.(?:c|h|cpp|cmake|proto|sh|py|md))\b/g) {
        my $path = $1;
        next if $path =~ /[A-Z]{3,}\w*\.(?!md)|\/[A-Z]+\//;
        fail("$name names $path, which does not exist")
            unless grep { -e "$_/$path" } $folder, $root, "$root/libprt", "$root/libprt/include", "$root/server";
    }
}

# Functions that a page names: walk().
my %called;
sub look_functions {
    my ($file, $text) = @_;
    (my $name = $file) =~ s/^\Q$root\E\///;
    while ($text =~ /(?<![\w.])([a-z_]\w*)\(\)/g) {
        fail("$name names $1(), which no source has") unless $called{$1};
    }
}

my @files;
find({no_chdir => 1, wanted => sub {
    if (-d && /\/(?:\.git|build[^\/]*|node_modules|seeds|out)$/) {
        $File::Find::prune = 1;
        return;
    }
    push @files, $_ if -f && /\.(?:c|h|cpp|md|cmake|proto|sh|py|txt)$/ && !/\/citations\.sh$/;
}}, $root);
for my $file (grep { !/\.md$/ } @files) {
    my $text = slurp($file);
    $called{$1} = 1 while $text =~ /\b([a-z_]\w*)\(/g;
}
for my $file (sort @files) {
    my $text = slurp($file);
    look($file, prose($file, $text));
    next unless $file =~ /\.md$/;
    look_paths($file, $text);
    look_functions($file, $text);
}
printf "%u files, %u sections, %u papers, %u equations: %u errors\n", scalar @files,
    scalar keys %section, scalar keys %key, scalar keys %equation, $bad;
exit($bad ? 1 : 0);
PERL
}

check "$root"

# A small tree: METHODS.md and the files it names. NAME, TEXT, what must be said.
copy=$(mktemp -d)
trap 'rm -rf "$copy"' EXIT
for file in METHODS.md $(grep -oE '[a-z]\w*/[a-z0-9_/]+\.(c|h|cpp)' "$root/libprt/METHODS.md" | sort -u); do
    from=$root/libprt/$file to=$copy/libprt/$file
    [ -e "$from" ] || { from=$root/$file to=$copy/$file; }
    [ -e "$from" ] || continue
    mkdir -p "${to%/*}"
    cp "$from" "$to"
done
check "$copy" >/dev/null || { echo "error: the copy of a good tree fails" >&2; exit 1; }

refuse() {
    printf '%s\n' "$2" >"$copy/libprt/$1"
    if said=$(check "$copy"); then
        echo "error: accepted in $1: $2" >&2
        exit 1
    fi
    case $said in
    *"$3"*) ;;
    *)
        echo "error: '$3' is missing from: $said" >&2
        exit 1
        ;;
    esac
    rm "$copy/libprt/$1"
}
refuse a.md 'The loop is in `core/nowhere.c`.' 'core/nowhere.c, which does not exist'
refuse a.md 'It begins in nowhere_at_all().' 'nowhere_at_all(), which no source has'
refuse a.c '// A law (METHODS §99).' 'METHODS §99'
refuse a.c '// A law (METHODS §1, 98).' 'METHODS §98'
refuse a.h '/* A law, contracted first (METHODS
 * section 97). */' 'METHODS §97'
refuse a.md 'See METHODS.md §3.96.' 'METHODS §3.96'
refuse a.cmake '# METHODS "Nowhere at all"' 'nowhere at all'
refuse a.c '// As Q99 does.' 'Q99'
refuse a.proto '// W05 eq 10-95' 'W05 eq 95'
refuse a.c '// Donner & Jensen 2005, eq 4 and 94' 'DJ05 eq 94'
mv "$copy/libprt/bake/single.c" "$copy/libprt/bake/renamed.c"
refuse a.c '// nothing' 'bake/single.c, which does not exist'
