#pragma once

#include "Components/SceneComponent.h"
#include "CoreMinimal.h"
#include "Interfaces/IHttpRequest.h"

#include "ArmbridgeViewComponent.generated.h"

class UArmbridgeComponent;
class UMeshComponent;
struct FArmbridgeJoint;
struct FArmbridgeVisual;

/**
 * Shows the server's arm below this component and moves it as the arm moves. Links, shapes and meshes come from the server,
 * so that the project needs no assets of it. The same actor has an armbridge component.
 */
UCLASS(ClassGroup = (Robotics), meta = (BlueprintSpawnableComponent))
class ARMBRIDGE_API UArmbridgeViewComponent : public USceneComponent
{
	GENERATED_BODY()

protected:
	virtual void BeginPlay() override;

private:
	UFUNCTION()
	void MoveJoints(const TArray<FString>& Names, const TArray<float>& PositionsRad);

	void Request(const FString& Url, TFunction<void(const FHttpResponsePtr&)> Then);
	void Build(const FString& Urdf, const FString& UrdfUrl);
	void Show(const FArmbridgeVisual& Visual);
	void ShowMesh(const FArmbridgeVisual& Visual, const TArray<uint8>& File);
	void Place(const FArmbridgeVisual& Visual, UMeshComponent* Mesh, const FVector& Scale);

	UPROPERTY()
	TObjectPtr<UArmbridgeComponent> Arm;

	UPROPERTY()
	TMap<FString, TObjectPtr<USceneComponent>> Links;

	TMap<FString, TSharedPtr<FArmbridgeJoint>> Joints;
};
