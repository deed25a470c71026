"""Converts commands of a leader about the cluster, and their results, from and to messages of the log."""

from __future__ import annotations

from typing import Any

from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_supernode.codecs.kind_codec import KindCodec
from stampede_rt_supernode.core.cluster.commands import (
    BeginTenure,
    FeatureLevelRaised,
    MarkTime,
    RaiseFeatureLevel,
    TenureBegun,
    TimeMarked,
)


def _tenure_message(operation: BeginTenure) -> pb.BeginTenureCommand:
    return pb.BeginTenureCommand(
        tenure=operation.tenure,
        supernode_id=operation.supernode_id,
        new_cluster_id=operation.new_cluster_id,
        new_lease_ttl_nanos=operation.new_lease_ttl_nanos,
        founded_anew=operation.founded_anew,
        takes_over=operation.takes_over,
        new_feature_level=operation.new_feature_level,
        new_join_key=operation.new_join_key,
        new_token_key=operation.new_token_key,
    )


def _read_tenure(message: pb.BeginTenureCommand) -> BeginTenure:
    return BeginTenure(
        tenure=message.tenure,
        supernode_id=message.supernode_id,
        new_cluster_id=message.new_cluster_id,
        new_lease_ttl_nanos=message.new_lease_ttl_nanos,
        founded_anew=message.founded_anew,
        takes_over=message.takes_over,
        new_feature_level=message.new_feature_level,
        new_join_key=message.new_join_key,
        new_token_key=message.new_token_key,
    )


def _mark_message(operation: MarkTime) -> pb.MarkTimeCommand:
    return pb.MarkTimeCommand(tenure=operation.tenure, after_index=operation.after_index)


def _read_mark(message: pb.MarkTimeCommand) -> MarkTime:
    return MarkTime(tenure=message.tenure, after_index=message.after_index)


def _begun_message(result: TenureBegun) -> pb.TenureBegunResult:
    return pb.TenureBegunResult(tenure=result.tenure, cluster_id=result.cluster_id)


def _read_begun(message: pb.TenureBegunResult) -> TenureBegun:
    return TenureBegun(tenure=message.tenure, cluster_id=message.cluster_id)


CODECS: tuple[KindCodec[Any, Any, Any, Any], ...] = (
    KindCodec(
        kind="begin_tenure",
        outcome="tenure_begun",
        operation=BeginTenure,
        result=TenureBegun,
        write=_tenure_message,
        read=_read_tenure,
        write_result=_begun_message,
        read_result=_read_begun,
    ),
    KindCodec(
        kind="mark_time",
        outcome="time_marked",
        operation=MarkTime,
        result=TimeMarked,
        write=_mark_message,
        read=_read_mark,
        write_result=lambda one: pb.TimeMarkedResult(marked=one.marked),
        read_result=lambda message: TimeMarked(marked=message.marked),
    ),
    KindCodec(
        kind="raise_feature_level",
        outcome="feature_level_raised",
        operation=RaiseFeatureLevel,
        result=FeatureLevelRaised,
        write=lambda one: pb.RaiseFeatureLevelCommand(feature_level=one.feature_level, tenure=one.tenure),
        read=lambda message: RaiseFeatureLevel(feature_level=message.feature_level, tenure=message.tenure),
        write_result=lambda one: pb.FeatureLevelRaisedResult(feature_level=one.feature_level),
        read_result=lambda message: FeatureLevelRaised(feature_level=message.feature_level),
    ),
)
