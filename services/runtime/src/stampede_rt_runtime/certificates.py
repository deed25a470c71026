"""Makes and reads the certificates of one cluster. Reads no file and no clock.

Keys are ECDSA over P-256. Every TLS library has it, and a signature costs a tenth of an RSA signature.
"""

from __future__ import annotations

import contextlib
import ipaddress
import re
import secrets
from dataclasses import dataclass
from datetime import datetime, timedelta

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from stampede_rt_runtime.identity import SERVICES, Identity, identity_among

BACKDATED = timedelta(minutes=5)  # the clocks of two machines seldom agree to the second
_COMMON_NAME_CHARS_MAX = 64
_HOST_NAME = re.compile(r"(?=.{1,253}$)[a-z0-9_-]{1,63}(\.[a-z0-9_-]{1,63})*", re.IGNORECASE)
# The errors of the library for a file without a certificate, an impossible field, or unknown contents.
_UNREADABLE = (
    ValueError,
    TypeError,
    UnsupportedAlgorithm,
    x509.DuplicateExtension,
    x509.InvalidVersion,
    x509.UnsupportedGeneralNameType,
)


class CertificateError(Exception):
    """A certificate or key cannot be used. The text says why."""


@dataclass(frozen=True, slots=True)
class IssuedCertificate:
    """A certificate with its private key, both PEM."""

    certificate: bytes
    key: bytes

    def __repr__(self) -> str:
        return "IssuedCertificate(...)"  # never show the key


@dataclass(frozen=True, slots=True)
class CertificateContents:
    """The contents of a certificate. `identity` is None for an authority, and for a certificate without exactly
    one identity.
    """

    subject: str
    issuer: str
    identity: Identity | None
    addresses: tuple[str, ...]
    not_before: datetime
    not_after: datetime
    is_authority: bool
    serial: int
    sha256: str

    @property
    def lifetime(self) -> timedelta:
        """The time for which the certificate was made, without the backdated part."""
        return self.not_after - self.not_before - BACKDATED

    def ends_soon(self, now: datetime, at_most: timedelta) -> bool:
        """Whether less than a third of the lifetime is left, and also less than `at_most`."""
        return self.not_after - now < min(at_most, self.lifetime / 3)


def make_authority(cluster: str, *, now: datetime, lifetime: timedelta) -> IssuedCertificate:
    """A new authority for `cluster`, signed by itself. It may sign certificates, but no further authorities."""
    key = ec.generate_private_key(ec.SECP256R1())
    # A cluster may have two authorities while one replaces the other. They need different names.
    name = _name(f"Stampede RT authority {secrets.token_hex(4)}", cluster)
    builder = _builder(name, name, key.public_key(), now, lifetime).add_extension(
        x509.BasicConstraints(ca=True, path_length=0), critical=True
    )
    usage = _key_usage(sign_certificates=True)
    signed = builder.add_extension(usage, critical=True).sign(key, hashes.SHA256())
    return IssuedCertificate(signed.public_bytes(serialization.Encoding.PEM), _key_bytes(key))


def issue(
    authority: IssuedCertificate, identity: Identity, addresses: tuple[str, ...], *, now: datetime, lifetime: timedelta
) -> IssuedCertificate:
    """A certificate for `identity`. A service's certificate also names its `addresses` (host names or IPs, no ports).

    It ends with its authority at the latest. Raises CertificateError.
    """
    signer, signer_key = _load_authority(authority)
    if identity.role in SERVICES and not addresses:
        raise CertificateError(f"a {identity.role} needs the addresses at which it is called")
    lifetime = min(lifetime, signer.not_valid_after_utc - now)
    if lifetime <= timedelta(0):
        raise CertificateError("the authority has expired; make a new one, and let all parts trust both for a while")
    key = ec.generate_private_key(ec.SECP256R1())
    names = [*map(_general_name, addresses), x509.UniformResourceIdentifier(identity.uri)]
    purposes = [ExtendedKeyUsageOID.CLIENT_AUTH]
    if identity.role in SERVICES:
        purposes.append(ExtendedKeyUsageOID.SERVER_AUTH)
    subject = _name(f"{identity.role} {identity.name}", identity.cluster)
    builder = (
        _builder(subject, signer.subject, key.public_key(), now, lifetime)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage(sign_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(signer_key.public_key()), critical=False)
    )
    signed = builder.sign(signer_key, hashes.SHA256())
    return IssuedCertificate(signed.public_bytes(serialization.Encoding.PEM), _key_bytes(key))


def describe(pem: bytes) -> list[CertificateContents]:
    """The contents of the certificates in `pem`, in order. Raises CertificateError."""
    try:
        return [_described(one) for one in x509.load_pem_x509_certificates(pem)]
    except _UNREADABLE as error:
        raise CertificateError("the file holds no certificate in PEM form; name a .pem file") from error


def serial_and_end(pem: bytes) -> tuple[str, int]:
    """The serial number of the first certificate in `pem`, in hexadecimal digits, and its end in Unix nanoseconds.

    Raises CertificateError.
    """
    first = describe(pem)[0]
    return serial_text(first.serial), int(first.not_after.timestamp()) * 10**9


def serial_text(serial: int) -> str:
    """A serial number in hexadecimal digits, as people write it."""
    return f"{serial:x}"


def cluster_of(authority: bytes) -> str:
    """The cluster of an authority's certificate. Raises CertificateError."""
    try:
        subject = x509.load_pem_x509_certificate(authority).subject
        found = subject.get_attributes_for_oid(NameOID.ORGANIZATION_NAME)
    except _UNREADABLE as error:
        raise CertificateError("the authority's ca.pem holds no certificate in PEM form") from error
    if not found:
        raise CertificateError(f"{_readable(subject)!r} is not an authority that `stampede certs init` made")
    return str(found[0].value)


def _described(certificate: x509.Certificate) -> CertificateContents:
    names, is_authority = _alternative_names(certificate), False
    with contextlib.suppress(x509.ExtensionNotFound):  # a certificate without this extension is not an authority
        is_authority = certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    addresses = [*names.get_values_for_type(x509.DNSName), *map(str, names.get_values_for_type(x509.IPAddress))]
    return CertificateContents(
        subject=_readable(certificate.subject),
        issuer=_readable(certificate.issuer),
        identity=identity_among(names.get_values_for_type(x509.UniformResourceIdentifier)),
        addresses=tuple(addresses),
        not_before=certificate.not_valid_before_utc,
        not_after=certificate.not_valid_after_utc,
        is_authority=is_authority,
        serial=certificate.serial_number,
        sha256=certificate.fingerprint(hashes.SHA256()).hex(),
    )


def _alternative_names(certificate: x509.Certificate) -> x509.SubjectAlternativeName:
    try:
        return certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return x509.SubjectAlternativeName([])


def _readable(name: x509.Name) -> str:
    found = name.get_attributes_for_oid(NameOID.COMMON_NAME)
    cluster = name.get_attributes_for_oid(NameOID.ORGANIZATION_NAME)
    common = str(found[0].value) if found else name.rfc4514_string()
    return f"{common} of {cluster[0].value!s}" if found and cluster else common


def _load_authority(authority: IssuedCertificate) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    try:
        certificate = x509.load_pem_x509_certificate(authority.certificate)
        key = serialization.load_pem_private_key(authority.key, password=None)
        # The library parses these fields only on access. The rest of the code relies on them.
        public_key, _, _ = certificate.public_key(), certificate.subject, certificate.not_valid_after_utc
    except _UNREADABLE as error:
        raise CertificateError(f"the authority cannot be read ({error})") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != public_key:
        raise CertificateError("the authority's key and certificate do not belong together")
    return certificate, key


def _general_name(address: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(address.strip("[]")))
    except ValueError:
        pass  # no IP address, so it is a name
    if not _HOST_NAME.fullmatch(address):
        raise CertificateError(
            f"{address!r} is not the name or IP address of a machine; give one without a port, such as s1.lab or "
            "10.0.0.11"
        )
    return x509.DNSName(address)


def _name(common: str, cluster: str) -> x509.Name:
    return x509.Name(
        [
            x509.NameAttribute(NameOID.ORGANIZATION_NAME, cluster),
            x509.NameAttribute(NameOID.COMMON_NAME, common[:_COMMON_NAME_CHARS_MAX]),
        ]
    )


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, now: datetime, lifetime: timedelta
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - BACKDATED)
        .not_valid_after(now + lifetime)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _key_usage(*, sign_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not sign_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=sign_certificates,
        crl_sign=sign_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def _key_bytes(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
