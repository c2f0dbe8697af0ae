"""`boresight webhook`: the key that encrypts the secrets of webhooks."""

from __future__ import annotations

import click

from boresight.settings import read_settings


@click.group()
def webhook() -> None:
    """Look after webhooks."""


@webhook.command(name="rotate-key")
@click.option("--forget-old", is_flag=True, help="Then remove the keys of before; older backups need them.")
def rotate_key(*, forget_old: bool) -> None:
    """Make a new key and encrypt every webhook's secret with it; servers that share the file go on.

    Secrets that no key here decrypts stay as they are.
    """
    from boresight.services.webhook_secrets import encrypt_all, encrypt_anew
    from boresight.store.sessions import opened, writing

    settings = read_settings()
    box = settings.secret_box
    with opened(settings.database_url) as engine:
        kept = encrypt_all(engine, box)
        box.add_key()
        with writing(engine) as session:
            count = encrypt_anew(session, box)
    forgotten = box.forget_old_keys() if forget_old else 0
    click.echo(f"{box.file}: a new key encrypts the secrets of {count} webhooks; {forgotten} older keys were removed.")
    if kept.sentence is not None:
        click.echo(kept.sentence, err=True)
